"""The numbers by which the twin decides, each with its meaning and origin; one file for each of its tasks."""
