"""Published alternatives, each written from its paper and measured beside camtopod; never shipped.

Each is given what camtopod has to find out: the true zones, no clutter, and a threshold chosen on
the ground truth.

* `crossings`: the events in the form the baselines take
* `findings`: the form of their results, and how these are scored
* links between zones: `closest` (Alkhateeb 2011), `correlation` (Makris, Ellis, Black 2004),
  `information` (Tieu, Dalley, Grimson 2005), `transfer` (Ito et al. 2011), `anonymous`
  (conditional least squares on counts), `hawkes` (Lewis, Mohler 2011)
* zones: `zoning` (k-means, HDBSCAN, mean shift, plain DaSpec)
* next camera: `oracle` (an oracle that is given the identities)
* links between cameras: `process_mining` (pm4py's correlation miner, Pourmirza 2015)
* next camera: `area_occupancy` (a rule of Home Assistant's)
* entries and exits: `frigate` (its motion detection and its decoding)
"""
