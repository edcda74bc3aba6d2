// The rules for the page's JavaScript, which the browser loads as it is. tsconfig.json has those of its types.
const js = require("@eslint/js");

const asHTML = ["innerHTML", "outerHTML", "insertAdjacentHTML", "write", "setHTMLUnsafe"];

module.exports = [
  js.configs.recommended,
  {
    rules: {
      // tsc knows the browser's names, and that `#frame ||= ...` is a use.
      "no-undef": "off",
      "no-unused-private-class-members": "off",
      eqeqeq: "error",
      "no-console": "error",
      "no-eval": "error",
      "no-implied-eval": "error",
      "no-restricted-properties": ["error", ...asHTML.map((property) => ({ property, message: "Text is never parsed as HTML." }))],
      "no-var": "error",
      "prefer-const": "error",
    },
  },
];
