// Figures are drawn when they come near the window: a page with a hundred of them opens at once, on a phone too.
(function () {
  "use strict";
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
  function draw(place) {
    if (place.dataset.drawn) { return; }
    place.dataset.drawn = "yes";
    const figure = figures[place.dataset.figure];
    if (window.innerWidth <= 860) { figure.layout.dragmode = false; }
    Plotly.newPlot(place, figure.data, figure.layout, config);
  }
  const places = Array.from(document.querySelectorAll(".plot"));
  if ("IntersectionObserver" in window) {
    const watcher = new IntersectionObserver(function (entries) {
      entries.filter((entry) => entry.isIntersecting).forEach(function (entry) {
        watcher.unobserve(entry.target);
        draw(entry.target);
      });
    }, { rootMargin: "600px" });
    places.forEach((place) => watcher.observe(place));
  } else {
    places.forEach(draw);
  }
  window.addEventListener("beforeprint", function () {
    places.forEach(draw);
    places.forEach((place) => Plotly.Plots.resize(place));
  });
})();
