"""Controller design from a model: gains, analysis of the loop, robustness."""
