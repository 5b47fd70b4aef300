"""The identified model of a rig for other tools: FMU, MATLAB, Python, LaTeX, Modelica.  `README.md` has the picture."""
