"""Commands that show the rigs to people and to SCADA systems."""
