"""The commands of a city: where to cut it, what runs it, one topology of it, and all in one."""
