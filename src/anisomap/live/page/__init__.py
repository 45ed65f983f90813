"""The page of a session in the browser: its server, what it shows, and what its buttons do."""
