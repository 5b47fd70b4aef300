"""What is known of a plant: its constants, the four parameters of the paper, its noise, its sources."""
