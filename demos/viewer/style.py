"""Colours of the window."""

PAPER, INK, FAINT, ACCENT = "#fafafa", "#22262b", "#5f666e", "#14468c"
IDLE, OVER, ON_INK = "#e6e9ed", "#ccd3dc", "#ffffff"
