"""What else could be used: other people's methods, each from its paper, measured beside ours. Never
in the product.

They are given what ours has to find out: the true zones, no clutter, and a threshold chosen on the
truth.

* `crossings`: the events as they get them; `findings`: what they answer, and how it is scored
* links between zones: `closest` (Alkhateeb 2011), `correlation` (Makris, Ellis, Black 2004), `information` (Tieu,
  Dalley, Grimson 2005), `transfer` (Ito et al. 2011), `anonymous` (conditional least squares on counts), `hawkes`
  (Lewis, Mohler 2011)
* zones: `zoning` (k-means, HDBSCAN, mean shift, plain DaSpec)
* the next camera: `told` (identities are known)
* entries and exits: `frigate` (its motion detection and how it comes by frames)
"""
