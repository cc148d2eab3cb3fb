"""Fit of a scene: people in frames seen by cameras, refined together.

A lack of people, frames or cameras costs nothing. ``fit_scene`` is the entry. A ``Scene`` holds calibrated views and
what was seen of each person in each of them. Each person has one shape, a pose a frame and a place in the world. Terms
are there for what a scene has alone: smooth motion with several frames, hiding with several people in a picture.
"""
