"""The demo: a body, a target and the refinement between them, to play with.

``state`` is the model and knows no picture library, ``scene`` draws it with PyVista, ``window`` adds sliders, buttons
and keys (``controls`` says what they do), ``web`` shows the window in a browser, ``record`` writes a refinement to a
file.
"""
