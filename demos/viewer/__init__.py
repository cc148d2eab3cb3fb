"""The demo: a body, a target and the refinement between them, to play with.

``state`` is the model and knows no picture library (``settings``, ``targets``, ``view``); ``scene`` draws it with
PyVista; ``window`` adds sliders, buttons, keys (``controls`` acts on them) and the table of what was tried
(``tradeoff``); ``web`` shows the window in a browser; ``recording`` writes a refinement, or the window, to a file. The
files ``motion_...`` are the same of a fitted film; both windows share ``plotted`` and ``controlled``.
"""
