"""What the simulation gets wrong, which physical cause explains it, and what the extended model gains."""
