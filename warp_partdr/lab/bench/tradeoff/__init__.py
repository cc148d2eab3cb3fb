"""``partdr bench tradeoff``: what accuracy a renderer, a gradient and a picture size buy, and for how much time."""
