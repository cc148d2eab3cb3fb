"""The errors that wrong input raises; they are below, where ``body`` can raise them too."""

from .body.errors import InputError as InputError
from .body.errors import check_each as check_each
from .body.errors import check_type as check_type
from .body.errors import shown as shown
