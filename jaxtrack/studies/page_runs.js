// "How many runs": trials and time for the standard error that is asked for.
for (const box of document.querySelectorAll("input[data-runs]")) {
  const rows = document.getElementById(box.dataset.runs).tBodies[0].rows;
  const spreads = box.dataset.spreads.split(" ").map(Number);
  const words = (seconds) => {
    for (const [least, unit, name] of [[172800, 86400, "days"], [7200, 3600, "hours"], [120, 60, "minutes"]])
      if (seconds >= least) return `${Math.round(seconds / unit)} ${name}`;
    return `${Math.round(seconds)} s`;
  };
  box.addEventListener("input", () => {
    const wanted = Number(box.value);
    spreads.forEach((spread, row) => {
      const trials = Math.max(Math.ceil((spread / wanted) ** 2), 1);
      const known = wanted > 0 && spread > 0 && Number.isFinite(trials);
      const cells = [...rows[row].cells].slice(-2);
      cells[0].textContent = known ? String(trials).replace(/\B(?=(\d{3})+$)/g, "\u00a0") : "–";
      cells[1].textContent = known && box.dataset.rate ? words(trials / Number(box.dataset.rate)) : "–";
    });
  });
}
