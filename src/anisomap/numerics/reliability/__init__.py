"""How reliable a correlation is: its sampling noise and its significance."""
