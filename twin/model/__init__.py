"""The plant model: constants, the paper's four parameters, causes that extend it, noise, provenance."""
