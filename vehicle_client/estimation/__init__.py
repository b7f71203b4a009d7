"""From wheel sensors to a kinematic summary: pure functions over the arrays of one trace."""
