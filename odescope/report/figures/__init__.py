"""The figures: from the plain data of a report to matplotlib, SVG and PNG, in processes of their own."""
