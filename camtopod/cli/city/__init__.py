"""The commands of a city: where to cut it, one topology of its districts, and all in one."""
