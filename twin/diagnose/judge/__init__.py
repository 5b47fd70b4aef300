"""What a model is worth on recordings that neither fitting nor choosing has seen."""
