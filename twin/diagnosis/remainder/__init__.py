"""Models of what no cause explains: curves, chosen and measured on recordings that no fit saw."""
