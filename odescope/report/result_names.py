"""What the files of a folder of results are called."""

from odescope.files import MODEL as MODEL

REPORT_PAGE, REPORT = "report.html", "report.json"
RESULT_FILES = (MODEL, "candidates.csv", "study.toml", REPORT_PAGE, REPORT)
NO_MODEL = "no_model.html"  # what a run leaves that ends without a model, beside the results of earlier ones
FIGURES = "figures"  # the folder beside them
PATH, PATH_TABLE = "path", "path.csv"  # that of the models from many terms to few, and the table of these beside it
PATH_MODEL = "_terms.json"  # what the names of these models end in, after how many terms they have
FACTORS = "factors"  # and the one of what is kept of logs that do not fit in memory
