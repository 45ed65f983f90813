"""Opening and parsing files: code shared by several formats."""
