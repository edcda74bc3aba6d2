"""Access control on the bus of a site: the rules, and the authority that issues certificates.

`rules` translates an access list to settings of zenoh; `authority` keeps the site's private key,
and issues and revokes certificates.
"""
