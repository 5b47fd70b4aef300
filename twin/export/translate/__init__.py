"""The kernels of the twin in other languages: specialised for one model, then written out.  No physics is here.

`values.py` what is known of an expression, `fold.py` arithmetic on that, `specialise.py` functions and `statements.py`
their bodies; `c.py` writes C.
"""
