"""The nodes of the OPC UA server: what there is of a board, its values and their quality."""
