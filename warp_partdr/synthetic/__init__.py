"""People of known truth: their poses, bodies, pictures and the noise of what is seen of them."""
