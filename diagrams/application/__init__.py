"""User-facing parts: commands, reports, figures, campaigns, benchmark. No block of a Diagram imports them."""

import lazy_loader

# `slipmap.figures` is found here on first use.
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules={"figures"})
