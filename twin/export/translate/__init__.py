"""The kernels of the twin in other languages: specialised for one model, then written out.  No physics is here.

`values.py`: known values of expressions; `fold.py`: arithmetic on them; `specialise.py`: functions; `statements.py`:
their bodies; `c.py`: output in C.
"""
