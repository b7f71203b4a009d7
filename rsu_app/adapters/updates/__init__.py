"""Where releases come from, and the shelf they are kept on. The one door to python-tuf on the road side unit.

Importing this does not import python-tuf: a unit is ready before it has to ask for news.
"""

from rsu_app.adapters.updates.limits import FetchLimits
from rsu_app.adapters.updates.repository import TufReleaseSource
from rsu_app.adapters.updates.shelf import FolderShelf

__all__ = ["FetchLimits", "FolderShelf", "TufReleaseSource"]
