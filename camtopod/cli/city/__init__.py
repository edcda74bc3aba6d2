"""The commands of a city: its districts, the files that run them, and their joint topology."""
