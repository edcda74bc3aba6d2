"""Made-up camera networks with known truth: events for `simulate`, pixels for `demo`."""
