"""Solver: it finds the bodies that explain observations (paper, section 3.4).

* ``ellipsoids``: fits of EllipBody to the observation of one person, or of a batch of people. Begin with ``fit_body``.
* ``mesh``: the mesh stage, which goes on from there with a detailed body. Begin with ``refine_mesh``.
* ``scene``: joint refinement of detailed bodies of people in the frames of several cameras. Begin with ``fit_scene``.
"""
