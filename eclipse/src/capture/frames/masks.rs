//! From what an image file holds to coverage by the object.

use render::image::Image;

/// The highest number of a label that is taken for one, where a mask has nothing brighter.
const LAST_LABEL: f32 = 8.0;
/// Coverage of a pixel that shows the object and nothing else.
const WHOLE: f32 = 0.999;
/// What most of the object has at least in a mask whose inside is uneven, as matting leaves it.
const NEARLY_WHOLE: f32 = 0.95;
/// Steps from black to white in files of 8 and of 16 bits.
const STEPS: [f32; 2] = [255.0, 65535.0];

/// The mask in a photograph's own alpha, its last channel; NaN where that is not finite.
pub(super) fn of_alpha(image: &Image) -> Image {
    let alphas = image.data.iter().skip(image.channels - 1);
    let data = alphas
        .step_by(image.channels)
        .map(|alpha| match alpha.is_finite() {
            true => alpha.clamp(0.0, 1.0),
            false => f32::NAN,
        });
    Image {
        channels: 1,
        data: data.collect(),
        ..*image
    }
}

/// The mask in a file of its own: its brightest colour times its alpha, so that white on black, white on nothing and
/// coloured labels all work. Of a file of small numbers, as programs that tell things apart count them, all but 0 is the object.
pub(super) fn of_file(image: &Image) -> Image {
    let colors = if image.channels.is_multiple_of(2) {
        image.channels - 1
    } else {
        image.channels
    };
    let coverage = |pixel: &[f32]| {
        let brightest = pixel[..colors].iter().copied().fold(0.0, f32::max);
        let alpha = if colors < pixel.len() {
            pixel[colors]
        } else {
            1.0
        };
        (brightest * alpha).clamp(0.0, 1.0)
    };
    let mut data: Vec<f32> = image
        .data
        .chunks_exact(image.channels)
        .map(coverage)
        .collect();
    if are_labels(&data) {
        data.iter_mut().for_each(|value| *value = value.ceil());
    }
    Image {
        channels: 1,
        data,
        ..*image
    }
}

/// A mask whose object is not quite white, in white: pixels that show it alone are what a run uses.
///
/// Where nothing is white, the brightest is; where most of the object is a little below that, as in mattes, all within a twentieth of
/// it is. Any other mask says how much of a pixel shows the object, and stays.
pub(super) fn whitened(mut mask: Image) -> Image {
    let mut inside: Vec<f32> = mask.data.iter().copied().filter(|m| *m > 0.5).collect();
    inside.sort_unstable_by(f32::total_cmp);
    let [Some(&middle), Some(&brightest)] = [inside.get(inside.len() / 2), inside.last()] else {
        return mask;
    };
    let white = match middle / brightest {
        most if (NEARLY_WHOLE..=WHOLE).contains(&most) => NEARLY_WHOLE * brightest,
        _ if brightest <= WHOLE => brightest,
        _ => return mask,
    };
    for value in &mut mask.data {
        *value /= white;
        // Not `min`, by which what is not finite would be white.
        if *value > 1.0 {
            *value = 1.0;
        }
    }
    mask
}

/// The brightest coverage of a mask of which nothing counts as the object, as its file has it: `40 of 255`; nothing for a black one.
///
/// That is what a file of labels looks like whose numbers go beyond [`LAST_LABEL`].
pub(super) fn brightest(mask: &Image) -> Option<String> {
    let brightest = mask.data.iter().copied().fold(0.0, f32::max);
    let is_whole = |value: f32| (value - value.round()).abs() < 1e-3;
    let counted = |steps: &f32| mask.data.iter().all(|value| is_whole(value * steps));
    (brightest > 0.0).then(|| match STEPS.iter().find(|steps| counted(steps)) {
        Some(steps) => format!("{:.0} of {steps}", brightest * steps),
        None => format!("{brightest:.3} of 1"),
    })
}

/// Whether all values are small whole numbers of steps: as coverage they would be an empty mask.
fn are_labels(values: &[f32]) -> bool {
    STEPS.into_iter().any(|steps| {
        values.iter().all(|value| {
            let label = value * steps;
            label < LAST_LABEL + 0.5 && (label - label.round()).abs() < 1e-3
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(channels: usize, values: &[f32]) -> Vec<f32> {
        let image = Image {
            width: values.len() / channels,
            height: 1,
            channels,
            data: values.to_vec(),
        };
        of_file(&image).data
    }

    #[test]
    fn small_numbers_are_labels() {
        for steps in STEPS {
            let labels = [0.0, 1.0, 3.0, 8.0].map(|label| label / steps);
            assert_eq!(of(1, &labels), [0.0, 1.0, 1.0, 1.0], "{steps}");
        }
        let coloured = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0].map(|label| label / 255.0);
        assert_eq!(of(3, &coloured), [1.0, 0.0]);
        assert_eq!(of(1, &[0.0, 0.0]), [0.0, 0.0]);
    }

    #[test]
    fn the_brightest_of_a_mask_is_told_as_its_file_has_it() {
        let told = |values: &[f32]| {
            let image = Image {
                width: values.len(),
                height: 1,
                channels: 1,
                data: values.to_vec(),
            };
            brightest(&image)
        };
        assert_eq!(told(&[0.0, 0.0]), None);
        assert_eq!(
            told(&[0.0, 3.0 / 255.0, 40.0 / 255.0]).unwrap(),
            "40 of 255"
        );
        assert_eq!(told(&[0.0, 9.0 / 65535.0]).unwrap(), "9 of 65535");
        assert_eq!(told(&[0.0, 0.123_456]).unwrap(), "0.123 of 1");
    }

    #[test]
    fn a_mask_that_is_not_quite_white_is_whitened() {
        let of = |values: &[f32]| {
            whitened(Image {
                width: values.len(),
                height: 1,
                channels: 1,
                data: values.to_vec(),
            })
            .data
        };
        let grey = 128.0 / 255.0;
        assert_eq!(of(&[0.0, 0.25 * grey, grey, grey]), [0.0, 0.25, 1.0, 1.0]);
        // A matte: uneven inside, its brightest pixel white.
        assert_eq!(of(&[0.0, 0.98, 0.98, 0.99, 1.0])[1..], [1.0; 4]);
        assert_eq!(of(&[0.0, 0.97, 0.98, 0.98, 0.99])[1..], [1.0; 4]);
        // Thin things cover no pixel wholly but one, and empty masks are told elsewhere.
        for kept in [
            vec![0.6, 0.7, 0.8, 1.0],
            vec![0.2, 0.4],
            vec![0.0, 1.0, 1.0, 0.98],
        ] {
            assert_eq!(of(&kept), kept);
        }
        // Alpha that is not finite stays so.
        assert!(of(&[f32::NAN, 0.9])[0].is_nan());
    }

    #[test]
    fn other_values_are_coverage() {
        for values in [
            [0.0, 1.0 / 255.0, 1.0],
            [0.0, 0.5, 0.25],
            [0.0, 9.0 / 255.0, 0.0],
            [0.0, 0.002, 0.003],
        ] {
            assert_eq!(of(1, &values), values);
        }
        assert_eq!(of(4, &[1.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]), [0.5, 0.0]);
    }
}
