"""What no cause explains, modelled: curves through what is left, chosen and measured on recordings that no fit saw."""
