"""Who may do what on the bus of a site: the rules, and the private authority that gives out the names."""
