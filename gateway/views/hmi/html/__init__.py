"""The pages as text: markup, the controls of a board, whole pages."""
