// Before anything is drawn, and where the system changes: dark or light, as was chosen here, else as the system has it.
(() => {
  const root = document.documentElement, system = matchMedia("(prefers-color-scheme: dark)");
  system.onchange = () => (root.dataset.theme = localStorage.getItem("theme") ?? (system.matches ? "dark" : "light"));
  system.onchange();
})();
