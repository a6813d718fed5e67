//! `--tui`: a running solve as a screen of its own, with the loss, the light as it stands, the pace and the time left.

use std::{
    io::{IsTerminal, Stderr, stderr},
    panic,
    sync::{
        Mutex, Once, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use ratatui::{
    Frame, Terminal,
    backend::CrosstermBackend,
    crossterm::{
        cursor, execute,
        terminal::{EnterAlternateScreen, LeaveAlternateScreen},
    },
    layout::{Constraint, Layout, Rect},
    style::{Color, Style, Stylize},
    symbols::Marker,
    text::Line,
    widgets::{Axis, Block, Chart, Dataset, Gauge, GraphType, Paragraph},
};
use render::image::Image;

use super::{line, share, thumbnail::Thumbnail};
use crate::{control::Progress, settings::Settings};

/// Screens come no closer than this, but for the first of a stage.
const INTERVAL: Duration = Duration::from_millis(100);
/// The house's orange.
const ACCENT: Color = Color::Rgb(0xd9, 0x77, 0x06);
/// A curve of more points is thinned to every second one.
const MOST_POINTS: usize = 4000;

/// The screen; the terminal is as it was when this is dropped, at a panic, and before the program is ended by a second Ctrl-C.
pub struct Dashboard {
    terminal: Mutex<Terminal<CrosstermBackend<Stderr>>>,
    view: Mutex<View>,
}

/// Whether the terminal shows our screen.
static SHOWN: AtomicBool = AtomicBool::new(false);

impl Dashboard {
    /// Takes the terminal of standard error for a run called `title`.
    ///
    /// Keys stay with the terminal: Ctrl-C interrupts as always.
    ///
    /// # Errors
    /// Standard error is no terminal, or cannot be written.
    pub fn begin(title: String, settings: &Settings) -> std::io::Result<Self> {
        if !stderr().is_terminal() {
            return Err(std::io::Error::other("standard error is not a terminal"));
        }
        static HOOKED: Once = Once::new();
        HOOKED.call_once(|| {
            let before = panic::take_hook();
            panic::set_hook(Box::new(move |info| {
                restore();
                before(info);
            }));
        });
        let terminal = Terminal::new(CrosstermBackend::new(stderr()))?;
        SHOWN.store(true, Ordering::SeqCst);
        execute!(stderr(), EnterAlternateScreen, cursor::Hide)?;
        let dashboard = Self {
            terminal: Mutex::new(terminal),
            view: Mutex::new(View::new(title, settings.time_limit)),
        };
        dashboard.draw(|_| true);
        Ok(dashboard)
    }

    /// Shows where the solve stands.
    pub fn update(&self, progress: &Progress) {
        self.draw(|view| view.update(progress));
    }

    /// Shows the light as it stands.
    pub fn light(&self, environment: &Image) {
        self.draw(|view| {
            view.light = Some(Thumbnail::new(environment));
            false
        });
    }

    /// Changes what is shown, and shows it if `change` wants it so or it is time.
    fn draw(&self, change: impl FnOnce(&mut View) -> bool) {
        let mut view = self.view.lock().unwrap_or_else(PoisonError::into_inner);
        let at_once = change(&mut view);
        if !at_once && view.drawn.is_some_and(|drawn| drawn.elapsed() < INTERVAL) {
            return;
        }
        view.drawn = Some(Instant::now());
        let mut terminal = self.terminal.lock().unwrap_or_else(PoisonError::into_inner);
        // A screen that cannot be shown is no reason to stop.
        let _ = terminal.draw(|frame| view.show(frame));
    }
}

impl Drop for Dashboard {
    fn drop(&mut self) {
        restore();
    }
}

/// Gives the terminal back as it was, if it was taken.
pub fn restore() {
    if SHOWN.swap(false, Ordering::SeqCst) {
        let _ = execute!(stderr(), LeaveAlternateScreen, cursor::Show);
    }
}

/// What is shown.
struct View {
    title: String,
    time_limit: Option<f64>,
    progress: Progress,
    /// Seconds and loss.
    curve: Vec<(f64, f64)>,
    light: Option<Thumbnail>,
    drawn: Option<Instant>,
}

impl View {
    fn new(title: String, time_limit: Option<f64>) -> Self {
        Self {
            title,
            time_limit,
            progress: Progress {
                stage: "beginning",
                loss: f64::NAN,
                ..Progress::default()
            },
            curve: Vec::new(),
            light: None,
            drawn: None,
        }
    }

    /// Takes news; whether they cannot wait.
    fn update(&mut self, progress: &Progress) -> bool {
        let other_stage = progress.stage != self.progress.stage;
        self.progress = progress.clone();
        if progress.loss.is_finite() {
            self.curve.push((progress.seconds, progress.loss));
            if self.curve.len() > MOST_POINTS {
                let mut index = 0;
                self.curve.retain(|_| {
                    index += 1;
                    index % 2 == 0
                });
            }
        }
        other_stage
    }

    fn show(&self, frame: &mut Frame<'_>) {
        let [head, middle, words, bar] = Layout::vertical([
            Constraint::Length(1),
            Constraint::Min(0),
            Constraint::Length(2),
            Constraint::Length(1),
        ])
        .areas(frame.area());
        let title = Line::from(vec![
            " eclipse ".bold().fg(ACCENT),
            self.title.clone().into(),
        ]);
        frame.render_widget(Paragraph::new(title), head);
        let [left, right] =
            Layout::horizontal([Constraint::Percentage(50), Constraint::Percentage(50)])
                .areas(middle);
        self.show_curve(frame, left);
        self.show_light(frame, right);
        let text = vec![
            Line::from(line(&self.progress, self.time_limit)),
            Line::from("Ctrl-C saves and ends; --resume goes on from there").dim(),
        ];
        frame.render_widget(Paragraph::new(text), words);
        let share = share(&self.progress, self.time_limit).unwrap_or(0.0);
        let gauge = Gauge::default().ratio(share).gauge_style(ACCENT);
        frame.render_widget(gauge, bar);
    }

    fn show_curve(&self, frame: &mut Frame<'_>, area: Rect) {
        let block = Block::bordered().title(" loss ");
        let (Some(first), Some(last)) = (self.curve.first(), self.curve.last()) else {
            frame.render_widget(block, area);
            return;
        };
        let losses = || self.curve.iter().map(|point| point.1);
        let (low, high) = losses().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        // Decades are shown as such.
        let decades = low > 0.0 && high > 10.0 * low;
        let scale = |loss: f64| if decades { loss.log10() } else { loss };
        let points: Vec<(f64, f64)> = self
            .curve
            .iter()
            .map(|&(seconds, loss)| (seconds, scale(loss)))
            .collect();
        let margin = 0.05 * (scale(high) - scale(low)).max(f64::MIN_POSITIVE);
        let seconds = |value: f64| format!("{value:.0} s");
        let chart = Chart::new(vec![
            Dataset::default()
                .marker(Marker::Braille)
                .graph_type(GraphType::Line)
                .style(Style::new().fg(ACCENT))
                .data(&points),
        ])
        .block(block)
        .x_axis(
            Axis::default()
                .bounds([first.0, last.0.max(first.0 + 1e-3)])
                .labels([seconds(first.0), seconds(last.0)]),
        )
        .y_axis(
            Axis::default()
                .bounds([scale(low) - margin, scale(high) + margin])
                .labels([format!("{low:.2e}"), format!("{high:.2e}")]),
        );
        frame.render_widget(chart, area);
    }

    fn show_light(&self, frame: &mut Frame<'_>, area: Rect) {
        let block = Block::bordered().title(" light, all directions ");
        let inner = block.inner(area);
        frame.render_widget(block, area);
        if let Some(light) = &self.light {
            frame.render_widget(light, inner);
        }
    }
}

#[cfg(test)]
mod tests {
    use ratatui::{backend::TestBackend, buffer::Buffer};

    use super::*;

    fn screen(view: &View, width: u16, height: u16) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| view.show(frame)).unwrap();
        terminal.backend().buffer().clone()
    }

    fn words(buffer: &Buffer) -> String {
        let width = usize::from(buffer.area.width);
        let rows = buffer.content.chunks(width);
        rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>() + "\n")
            .collect()
    }

    fn view() -> View {
        let mut view = View::new("potatoes, fast preset".to_owned(), Some(100.0));
        for iteration in 1..=40u64 {
            view.update(&Progress {
                stage: "environment and masks",
                iteration,
                iterations: None,
                loss: 1e5 / iteration as f64,
                samples_per_second: 2.5e7,
                seconds: iteration as f64,
            });
        }
        view
    }

    #[test]
    fn the_screen_tells_stage_pace_time_left_and_how_to_end() {
        let text = words(&screen(&view(), 90, 24));
        for expected in [
            "potatoes, fast preset",
            "environment and masks · iteration 40",
            "25.0 M samples/s",
            "1 min 00 s left",
            "Ctrl-C saves and ends",
            "40%",
            "2.50e3",
            "1.00e5",
            "40 s",
        ] {
            assert!(text.contains(expected), "no `{expected}` in\n{text}");
        }
    }

    #[test]
    fn the_curve_falls_from_left_to_right() {
        let buffer = screen(&view(), 90, 24);
        let braille = |x: u16, y: u16| {
            let symbol = buffer[(x, y)].symbol().chars().next().unwrap_or(' ');
            ('\u{2801}'..='\u{28ff}').contains(&symbol)
        };
        let top = |x: u16| (0..24).find(|&y| braille(x, y));
        let columns: Vec<u16> = (0..45).filter_map(top).collect();
        assert!(columns.len() > 20, "{}", words(&buffer));
        assert!(columns.is_sorted(), "{columns:?}");
        assert!(columns[columns.len() - 1] > columns[0] + 8, "{columns:?}");
    }

    #[test]
    fn the_light_is_drawn_in_its_colours() {
        let mut view = view();
        let mut light = Image::filled(100, 50, 3, 0.0);
        // Red on the left, blue on the right.
        for (index, texel) in light.data.chunks_exact_mut(3).enumerate() {
            texel[if index % 100 < 50 { 0 } else { 2 }] = 1.0;
        }
        view.light = Some(Thumbnail::new(&light));
        let buffer = screen(&view, 90, 24);
        let cells = || buffer.content.iter().filter(|cell| cell.symbol() == "▀");
        let count = |colour: Color| {
            cells()
                .filter(|cell| cell.fg == colour && cell.bg == colour)
                .count()
        };
        let (red, blue) = (count(Color::Rgb(255, 0, 0)), count(Color::Rgb(0, 0, 255)));
        // Twice as wide as high: 43 columns of the inner area give 21 rows of half a cell each.
        assert!(red > 180 && blue > 180, "{red} {blue}\n{}", words(&buffer));
        assert!(cells().count() - red - blue <= 11);
    }

    #[test]
    fn small_terminals_and_strange_losses_are_harmless() {
        for (width, height) in [(1, 1), (10, 3), (20, 6), (300, 2)] {
            screen(&view(), width, height);
        }
        for losses in [[0.0, 0.0], [-1.0, 5.0], [3.0, 3.0]] {
            let mut view = View::new(String::new(), None);
            for loss in losses {
                view.update(&Progress {
                    loss,
                    ..Progress::default()
                });
            }
            screen(&view, 60, 20);
        }
    }

    #[test]
    fn a_long_run_keeps_a_short_curve_with_its_end() {
        let mut view = View::new(String::new(), None);
        for iteration in 0..50_000u64 {
            view.update(&Progress {
                loss: 1.0,
                seconds: iteration as f64,
                ..Progress::default()
            });
        }
        assert!(view.curve.len() <= MOST_POINTS);
        assert_eq!(view.curve.last().unwrap().0, 49_999.0);
    }
}
