"""The public functions of the twin and their results; `twin.__all__` lists them."""
