"""The formula book: the paper's equations as one function each, in float64 NumPy, slow and obvious.

``index`` leads from an equation's number to its function, kernel, torch function and test; ``python -m
warp_partdr.reference 12`` prints that. The equations 3 to 6 and 19 are in ``losses``, 8 and 9 in ``mesh``, 10 to 12 in
``partdr``, 13 to 15 in ``ellipbody``, 16 to 18 in ``registration``. Of our own are the definitions of the exact
renderer, ``ellipsoids``, and of its other two gradients, ``coverage`` and ``edges``, of ``capsules``, which keep bodies
apart, and of ``own_pixels``, which tell whose a picture's pixels are. Tests hold all kernels to these functions; no
other part of the package imports them, and they import NumPy alone.
"""
