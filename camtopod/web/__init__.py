"""The page: a site's topology, predictions and health in a browser; `camtopod report` writes the same as one file."""
