"""The rig as scripts of MATLAB, Octave and Python that need no part of this product."""
