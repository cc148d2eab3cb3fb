"""Confidence in fitted bodies: how likely a body is right, and which of its limbs are guessed."""
