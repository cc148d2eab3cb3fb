"""Fit of a scene: people in frames from one or several cameras, refined together.

``fit_scene`` is the entry. A ``Scene`` holds calibrated views and the observations of each person. Each person has one
shape, and in each frame a pose and a position in the world. Some terms belong to scenes alone: smooth motion if there
are several frames, and hidden pixels if several people are in a picture. A scene of one person, frame or camera is
fitted like any other, and pays nothing for the terms that it lacks.
"""
