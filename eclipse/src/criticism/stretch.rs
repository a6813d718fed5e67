//! Neighbouring frames that differ from their simulation alike, for people.

use super::locate::HotSpot;

/// Where photographs differ most from their simulation: one hot spot, or those of neighbouring frames that have its sign.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// The first frame and the last, counted from zero.
    pub frames: [usize; 2],
    /// Their names, where these say more than their numbers.
    pub names: Option<[String; 2]>,
    /// Mean relative residual of the hot spots, by what noise lets be known of each; positive where photographs are brighter.
    pub relative: f64,
    /// Its standard error.
    pub error: f64,
    /// The middle of the strongest hot spot, pixels.
    pub middle: [f32; 2],
}

impl Stretch {
    /// Around the first of these, the strongest.
    pub fn around(spots: &[HotSpot]) -> Option<Self> {
        let first = spots.first()?;
        let alike = || spots.iter().filter(|s| s.sigma * first.sigma > 0.0);
        let hot = |frame: usize| alike().any(|s| s.frame == frame);
        let [mut low, mut high] = [first.frame; 2];
        while low > 0 && hot(low - 1) {
            low -= 1;
        }
        while hot(high + 1) {
            high += 1;
        }
        let (mut weights, mut sum) = (0.0, 0.0);
        let of_one = std::slice::from_ref(first).iter();
        let within = alike().filter(|s| (low..=high).contains(&s.frame));
        let counted: Vec<&HotSpot> = if low == high {
            of_one.collect()
        } else {
            within.collect()
        };
        for spot in counted {
            let weight = spot.relative_error().max(1e-12).powi(-2);
            weights += weight;
            sum += weight * spot.relative;
        }
        let ends = [low, high].map(|frame| alike().find(|spot| spot.frame == frame));
        let names = ends.map(|end| end.map_or("", |spot| &spot.name));
        let is_its_number = |(name, frame): (&&str, usize)| name.parse() == Ok(frame);
        let told = !names.iter().zip([low, high]).all(is_its_number);
        Some(Self {
            frames: [low, high],
            names: told.then(|| names.map(str::to_owned)),
            relative: sum / weights,
            error: weights.sqrt().recip(),
            middle: first.middle(),
        })
    }

    /// Its frames, and in a single one the place.
    pub fn place(&self) -> String {
        let [low, high] = self.frames;
        let [x, y] = self.middle;
        let names = self.called();
        if low == high {
            format!("frame {low}{names} around pixel ({x:.0}, {y:.0})")
        } else {
            format!("frames {low}–{high}{names}")
        }
    }

    /// The names, in brackets.
    fn called(&self) -> String {
        match &self.names {
            None => String::new(),
            Some([first, last]) if first == last => format!(" (“{first}”)"),
            Some([first, last]) => format!(" (“{first}” to “{last}”)"),
        }
    }

    /// A sentence: where, how much, and how surely.
    pub fn sentence(&self) -> String {
        let [low, high] = self.frames;
        let [x, y] = self.middle;
        let sign = if self.relative > 0.0 {
            "brighter"
        } else {
            "darker"
        };
        let much = format!(
            "{:.1} ± {:.1} % {sign} on average",
            100.0 * self.relative.abs(),
            100.0 * self.error
        );
        let names = self.called();
        if low == high {
            format!(
                "Frame {low}{names} is {much} than its simulation around pixel ({x:.0}, {y:.0}) after light and material are refitted."
            )
        } else {
            format!(
                "Frames {low}–{high}{names} are {much} than their simulation where they differ most, after light and material are refitted."
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(frame: usize, relative: f64, sigma: f64) -> HotSpot {
        HotSpot {
            frame,
            name: format!("{frame:03}"),
            pixels: [10.0, 20.0, 30.0, 50.0],
            surface_point: [0.0; 3],
            sigma,
            relative,
            shared: None,
        }
    }

    #[test]
    fn neighbouring_frames_are_told_together_with_their_mean() {
        // Errors of half a percent each; frame 8 is darker, frame 3 no neighbour.
        let spots = [
            spot(6, 0.05, 10.0),
            spot(8, -0.04, -8.0),
            spot(7, 0.04, 8.0),
            spot(5, 0.03, 6.0),
            spot(3, 0.03, 6.0),
        ];
        let stretch = Stretch::around(&spots).unwrap();
        assert_eq!(stretch.frames, [5, 7]);
        assert!((stretch.relative - 0.04).abs() < 1e-12);
        assert!((stretch.error - 0.005 / 3f64.sqrt()).abs() < 1e-12);
        let told = stretch.sentence();
        assert!(
            told.starts_with("Frames 5–7 are 4.0 ± 0.3 % brighter on average"),
            "{told}"
        );
        assert_eq!(stretch.place(), "frames 5–7");
    }

    #[test]
    fn one_frame_is_told_with_its_place() {
        let spots = [spot(4, -0.082, -16.4), spot(4, -0.05, -5.0)];
        let told = Stretch::around(&spots).unwrap().sentence();
        let expected =
            "Frame 4 is 8.2 ± 0.5 % darker on average than its simulation around pixel (20, 35)";
        assert!(told.starts_with(expected), "{told}");
        assert_eq!(Stretch::around(&[]), None);
    }

    #[test]
    fn names_are_told_where_they_are_no_numbers() {
        let named = |frame: usize| HotSpot {
            name: format!("IMG_{}", 10 * frame),
            ..spot(frame, 0.05, 10.0)
        };
        let both = Stretch::around(&[named(6), named(7)]).unwrap();
        assert_eq!(both.place(), "frames 6–7 (“IMG_60” to “IMG_70”)");
        let one = Stretch::around(&[named(6)]).unwrap();
        assert!(one.sentence().starts_with("Frame 6 (“IMG_60”) is 5.0 "));
    }
}
