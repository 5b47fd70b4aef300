"""The model and its critic: the paper's equations in step with a rig, and where they part."""
