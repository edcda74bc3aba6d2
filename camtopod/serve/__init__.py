"""Everything that can fail: the bus, the journal, the clock, the daemon around the learner."""
