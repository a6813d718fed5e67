//! What is made of a result: scores, exports, pictures in other light, the report and its viewer in a browser.

mod evaluate;
mod export;
mod loaded;
mod relight;
mod report;
mod stanford_orb;
mod viewer;
