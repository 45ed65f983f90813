"""Agreement of the similarities of sensors with stated positions, and what would improve it."""
