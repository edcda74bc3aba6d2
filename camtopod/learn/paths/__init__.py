"""A second opinion on where objects appear next: paths between cameras (METHOD 10).

The fit for prediction (`camtopod.learn.next_camera`) has a histogram of lags for each pair of
zones, and its bins widen with the lag. Where positions or events are few, a model with few
parameters finds other things: a *path* leads from one camera to another, a *share* of the
departures takes it, and the lag is distributed about its *place* with its *width*. Each of the two
is one point of a broad posterior, and they are wrong in different places, so that their mean
predicts better than either. In the order to read:

* `camera_lags`: the candidates of each pair of cameras, by lag
* `dictionary`: peaks of these lags; most are no paths, and the fit decides
* `path_fit`: joint EM over all paths
* `opinion`: when it is asked for; the rows that are published
"""

from camtopod.learn.paths.opinion import is_wanted as is_wanted, second_opinion as second_opinion
