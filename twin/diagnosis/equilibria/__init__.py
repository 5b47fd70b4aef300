"""The diagnosis of a campaign that has points of rest alone."""
