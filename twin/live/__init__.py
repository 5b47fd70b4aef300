"""What a live board has just done, as a campaign: the newest minutes of the gateway's log, cut into recordings."""
