"""The commands of a city: where to cut it, and one topology of its districts."""
