"""Colours of the window."""

PAPER, INK, FAINT, ACCENT = "#fafafa", "#22262b", "#70767e", "#14468c"
