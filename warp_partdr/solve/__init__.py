"""The solver: bodies that explain what was seen (paper, section 3.4).

* ``ellipsoids``: EllipBody before one observation, and many such fits side by side. ``fit_body`` is the entry.
* ``mesh``: the mesh stage, which fits a detailed body from there. ``refine_mesh`` is the entry.
* ``scene``: people in frames seen by cameras, as detailed bodies, refined together. ``fit_scene`` is the entry.
"""
