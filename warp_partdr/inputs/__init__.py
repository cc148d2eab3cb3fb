"""From files and pixels to what a fit sees of one person."""
