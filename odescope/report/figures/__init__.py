"""The figures: from the plain data of a report to matplotlib, SVG and PNG.

draw_lines, draw_grids   the drawing itself: lines over time and frequency; grids of terms and candidates
style, labels            what all figures share
catalogue                which figures a report has, and their captions
processes                drawing in processes of their own
notebook                 a function for each figure of a result
"""
