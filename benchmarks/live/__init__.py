"""What live sessions keep up with and show."""
