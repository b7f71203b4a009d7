"""The authority: certifies road side units and pseudonyms of vehicles, and revokes what it certified.

folder        its keys and its register on a disk
register      what it has issued and revoked, an event a line
cli           the command `roadgrip-authority`

Imports nothing of the laboratory: it runs on a machine that has nothing else, away from units and networks.
"""
