"""The physical causes that the paper's model leaves out, one file each; `catalogue.py` lists them."""
