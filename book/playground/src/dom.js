// Makes elements of the page.

let made = 0;

/** A new id. */
export const newId = () => `playground-${(made += 1)}`;

/**
 * @param {string} tag
 * @param {Record<string, unknown>} attributes true sets an empty one, false and null none; "on..." is a listener
 * @param {...(Node | string)} children
 * @returns {HTMLElement}
 */
export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== null) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}
