"""The colours of figures and pages: those of Okabe and Ito, which survive colour blindness."""

BLACK, BLUE, VERMILLION, GREEN, ORANGE, SKY = "#000000", "#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9"
GREY, PALE, RECORDED = "#6b7280", "#fdf3d0", "#b4b8bf"
