// The bundler collects stylesheets into page.css.
declare module "*.css";
