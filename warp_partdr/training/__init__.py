"""Training of the networks: people made on the fly, what they are trained on, and how."""
