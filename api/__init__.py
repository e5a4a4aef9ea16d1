"""The HTTP service: adapters around :mod:`fitter`, nothing numerical."""
