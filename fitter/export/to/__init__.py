"""One module per target, each with a ``TARGET``."""
