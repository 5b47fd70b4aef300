"""The diagnosis: where the simulation is wrong, which physical cause explains it, what the extended model gains."""
