"""From what road authorities publish to a section: pure parsers, then one fit.

Each parser turns text into a `survey.SurveyLine`; `fit.section_of_survey` smooths it, resamples it and makes the
section. Nothing here opens a file. Whatever is wrong with the input comes out as a `SectionError` in plain words.
"""
