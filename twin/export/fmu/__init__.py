"""FMUs: the rig as a co-simulation unit of FMI 2.0 or 3.0, with C sources and a binary for this machine."""
