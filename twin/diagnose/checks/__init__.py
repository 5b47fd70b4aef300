"""May the answer be believed: consistent recordings, no change during the campaign, no outlier."""
