// Light or dark: as the system has it, until somebody chooses; before anything is drawn, so that nothing flashes.
(() => {
  const root = document.documentElement, KEY = "board51-theme";
  const kept = () => {
    try {
      return localStorage.getItem(KEY);
    } catch {
      return null; // a browser that keeps nothing
    }
  };
  const wish = matchMedia("(prefers-color-scheme: dark)");
  const show = (theme) => (root.dataset.theme = theme ?? (wish.matches ? "dark" : "light"));
  show(kept());
  wish.addEventListener("change", () => show(kept()));
  document.addEventListener("click", (event) => {
    if (!event.target.closest?.("[data-theme-switch]")) return;
    show(root.dataset.theme === "dark" ? "light" : "dark");
    try {
      localStorage.setItem(KEY, root.dataset.theme);
    } catch {
      // It holds for this page alone.
    }
  });
})();
