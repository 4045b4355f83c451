"use strict";
(() => {
  const PAPER_COLUMN_PX = 334; // half of A4's width between the margins, less the gap
  const waiting = new Map();
  const touch = matchMedia("(pointer: coarse)").matches;
  const settings = {
    responsive: true,
    displaylogo: false,
    displayModeBar: matchMedia("(hover: hover)").matches ? "hover" : false,
    modeBarButtonsToRemove: ["toImage", "select2d", "lasso2d"], // an image would lack the labels
  };

  const draw = (place, data) => {
    const figure = JSON.parse(data.textContent);
    figure.layout.dragmode = touch ? false : "zoom"; // a finger on a plot scrolls the page
    waiting.delete(place);
    return Plotly.newPlot(place, figure.data, figure.layout, settings);
  };

  for (const data of document.querySelectorAll("script[data-plot]")) {
    waiting.set(document.getElementById(data.dataset.plot), data);
  }
  // one after the other, in the order of the page: its text can be read and scrolled from the start
  const next = () => {
    const [first] = waiting;
    if (first) {
      draw(...first);
      setTimeout(next);
    } else {
      document.body.dataset.drawn = "all";
    }
  };
  next();

  // a drawing does not shrink with the paper by itself
  addEventListener("beforeprint", () => {
    for (const [place, data] of [...waiting]) draw(place, data);
    for (const place of document.querySelectorAll(".plot")) {
      const height = place.classList.contains("equal") ? 302 : 234;
      Plotly.relayout(place, { width: PAPER_COLUMN_PX, height, autosize: false });
    }
  });
  addEventListener("afterprint", () => {
    for (const place of document.querySelectorAll(".plot")) {
      Plotly.relayout(place, { width: null, height: null, autosize: true });
    }
  });
})();
