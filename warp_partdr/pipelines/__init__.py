"""Pipelines from files to fitted people: a photo, a film, and several films that were taken at the same time.

They find people by networks, match people between films, find the poses of cameras, and give the solver its scenes.
"""
