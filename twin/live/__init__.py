"""The newest minutes of a live board as a campaign: the gateway's log, cut into recordings."""
