"""Parameters, their likelihood, its maximum, and what a right model would leave."""
