"""Files of users: nothing is unpickled, and nothing in them is lost silently."""
