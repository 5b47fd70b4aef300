"""The way from a campaign to a better model of a rig: what lies in its folders, and the work that makes more of it."""
