"""The workbench: a local page on the logs, studies and results of one folder.

access, server   who may see it, and how it is served
folder, jobs     what is in the folder, and the runs that it holds
log_file, log_study, overview, study_text, form, excitation    what the pages work with
frame, charts, view_*    the pages
"""
