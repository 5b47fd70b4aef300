"""The answer for people: sentences, figures, pages, model files."""
