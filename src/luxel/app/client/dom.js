// Small pieces of the page.

/**
 * Look up elements by id inside `root` only: a page may hold several apps.
 * @param {HTMLElement} root
 */
export function finder(root) {
  /** @template {HTMLElement} [T=HTMLInputElement] @param {string} id @returns {T} */
  return (id) => {
    const found = root.querySelector(`#${id}`);
    if (found === null) throw new Error(`the page has no element #${id}`);
    return /** @type {T} */ (found);
  };
}

/** What lists hold. @type {WeakMap<HTMLElement, string>} */
const filled = new WeakMap();

/** @param {HTMLElement} select @param {[string, string][]} options value and text */
export function fill(select, options) {
  const wanted = JSON.stringify(options);
  if (filled.get(select) === wanted) return; // an open list would close
  filled.set(select, wanted);
  const { value } = /** @type {HTMLSelectElement} */ (select);
  select.replaceChildren(...options.map(([each, text]) => new Option(text, each)));
  if (options.some(([each]) => each === value)) /** @type {HTMLSelectElement} */ (select).value = value;
}

/** @param {() => void} action @param {number} delay milliseconds */
export function debounced(action, delay) {
  let timer = 0;
  const later = () => {
    clearTimeout(timer);
    timer = window.setTimeout(() => { timer = 0; action(); }, delay);
  };
  /** Whether the action is still to come. */
  later.pending = () => timer !== 0;
  return later;
}

/** Hand a file to the user. @param {Blob} blob @param {string} name */
export function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
