"""The study: what the paper reports, made again, and what it leaves open. One chapter a module, one command a part."""
