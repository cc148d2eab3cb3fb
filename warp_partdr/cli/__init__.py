"""The command ``partdr``, a file a command."""
