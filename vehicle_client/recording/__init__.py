"""Recorded drives: from columns of numbers, whoever wrote them, to traces and back; no file is opened here."""
