"""From what road authorities publish to a surveyed line: pure parsers.

Each parser turns text into a `roadgrip.survey.SurveyLine`; `roadgrip.survey_fit` smooths it, resamples it and makes the
section. Nothing here opens a file. Whatever is wrong with the input comes out as a `SectionError` in plain words.
"""
