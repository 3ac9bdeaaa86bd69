import { Assets } from "./assets.js";
export { Assets };
