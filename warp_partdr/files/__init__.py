"""Files that users bring: nothing is unpickled, and nothing in them is lost without a word."""
