"""Command ``partdr``: each file holds one of its commands."""
