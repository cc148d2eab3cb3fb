"""Pipelines from files to fitted people: a photo, a film, and several films of one moment.

They find people by networks, decide who is who and where cameras are, and give the solver its scenes.
"""
