"""A controller for the board from a model file: gains, what they are worth, and how sure that is."""
