// Plots that move or hold many points, by uPlot, which views find as window.kilter.uPlot.
import uPlot from "uplot";

window.kilter = window.kilter || {};
window.kilter.uPlot = uPlot;
