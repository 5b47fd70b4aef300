"""The evaluation of models on recordings that neither fitting nor selection used."""
