"""Long studies of the models against references of their own: ``python -m tests.evidence``."""
