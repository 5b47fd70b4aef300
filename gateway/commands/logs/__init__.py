"""Commands over logs: make them, change their form, play them."""
