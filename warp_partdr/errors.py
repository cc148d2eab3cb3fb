"""The error that a user's input raises; where it can be raised from everywhere is below ``body``."""

from .body.errors import InputError as InputError
from .body.errors import shown as shown
