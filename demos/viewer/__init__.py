"""The demo: a body, a target and the refinement between them, to play with.

``state`` is the model and knows no picture library, ``scene`` draws it with PyVista, ``window`` adds sliders and keys,
``record`` writes a refinement to a file.
"""
