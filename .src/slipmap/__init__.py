"""slipmap."""
