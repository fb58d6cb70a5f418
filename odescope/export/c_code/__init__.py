"""C99 that runs a model: its templates, and what fills them."""
